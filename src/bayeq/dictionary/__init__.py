"""Dictionaries: families of candidate terms and their evaluation."""

from bayeq.dictionary.build import FAMILIES, Family, build_dictionaries, build_dictionary, evaluate_terms, slopes_of
from bayeq.dictionary.specification import Specification, Variables, of_equations, written

__all__ = [
    "FAMILIES", "Family", "Specification", "Variables", "build_dictionaries", "build_dictionary", "evaluate_terms",
    "of_equations", "slopes_of", "written",
]  # fmt: skip
