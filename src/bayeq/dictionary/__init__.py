"""Dictionaries: families of candidate terms and their evaluation."""

from bayeq.dictionary.build import FAMILIES, build_dictionary, evaluate_terms
from bayeq.dictionary.design import Design, DroppedTerm, build_design
from bayeq.dictionary.family import Variables

__all__ = [
    "FAMILIES",
    "Design",
    "DroppedTerm",
    "Variables",
    "build_design",
    "build_dictionary",
    "evaluate_terms",
]
