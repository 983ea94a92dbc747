"""The table of file formats: what each is called, how its files are known, and the module that reads them.

A new format is one new file in this folder and a row in `FORMATS`.
"""

from __future__ import annotations

from bayeq.records.formats.table import FORMATS, Format, format_of, suffixes, writers

__all__ = ["FORMATS", "Format", "format_of", "suffixes", "writers"]
