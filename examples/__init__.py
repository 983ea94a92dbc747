"""Worked examples on measured records: `python -m examples` writes what docs/examples.md shows."""
