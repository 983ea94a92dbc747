"""Dictionaries: families of candidate terms and their evaluation."""

from bayeq.dictionary.build import FAMILIES, build_dictionary, evaluate_terms
from bayeq.dictionary.family import Variables

__all__ = ["FAMILIES", "Variables", "build_dictionary", "evaluate_terms"]
