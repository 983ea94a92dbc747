"""How to cite bayeq, and the paper whose method it implements."""

from __future__ import annotations

PAPER_AUTHORS = ("Rajdip Nayek", "Keith Worden", "Elizabeth J. Cross")
PAPER_TITLE = "Equation Discovery Using an Efficient Variational Bayesian Approach with Spike-and-Slab Priors"
PAPER = f"{', '.join(PAPER_AUTHORS)}, {PAPER_TITLE}"

TEXT = """\
Please cite the paper that the method is from, and the program:

{paper}.

The bayeq developers, bayeq: Bayesian equation discovery, version {version}.

@misc{{nayek-worden-cross,
  author = {{{authors}}},
  title = {{{{{title}}}}},
}}

@software{{bayeq,
  author = {{{{The bayeq developers}}}},
  title = {{{{bayeq: Bayesian equation discovery}}}},
  version = {{{version}}},
}}"""


def citation() -> str:
    """References to the paper and to this version of bayeq, as text and as BibTeX."""
    from importlib.metadata import version

    return TEXT.format(paper=PAPER, authors=" and ".join(PAPER_AUTHORS), title=PAPER_TITLE, version=version("bayeq"))
