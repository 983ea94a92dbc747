"""Engines with scikit-learn's interface."""
