"""Fuzzing of every parser: one target each, a kept corpus, and a driver (``python -m tests.fuzz --help``)."""
