"""One target under atheris, in a process of its own: ``python -m tests.fuzz.coverage TARGET STATE CORPUS OPTIONS``."""

from __future__ import annotations

import sys
import warnings
from pathlib import Path


def main() -> None:
    """Fuzz until the number of runs is reached; libFuzzer then ends the process."""
    import atheris

    with atheris.instrument_imports(include=["bayeq"]):
        import bayeq.cli.app
        import bayeq.equation.load
        import bayeq.expressions
        import bayeq.records.io  # noqa: F401
    from tests.fuzz.__main__ import Watch

    name, state, *options = sys.argv[1:]
    watch = Watch(name, "atheris", Path(state))
    warnings.simplefilter("ignore")

    def one(data: bytes) -> None:
        watch.answer(data)

    atheris.Setup([sys.argv[0], *options], one)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
