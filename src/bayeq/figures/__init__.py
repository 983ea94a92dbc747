"""Figures: records in, files out. Nothing is computed here.

style    the look of all figures, and how they are written
figures  what can be drawn
"""
