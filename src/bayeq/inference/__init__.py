"""Engines: from a Gram matrix to a posterior; `engines` is their table."""
