"""Run the examples on the measured records.

python -m examples                # all of them: docs/examples.md, docs/figures, docs/tables/examples.csv
python -m examples tanks pendulum # these, on the screen only
python -m examples --data FOLDER  # records elsewhere than in $BAYEQ_DATA or ../shared/data
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

from examples import air_track, coupled, double_pendulum, encoder, pendulum, populations, tanks
from examples.page import Example, put_blocks, write_figure, write_table

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGE = DOCS / "examples.md"
EXAMPLES = {
    module.NAME: module for module in (air_track, coupled, pendulum, double_pendulum, encoder, populations, tanks)
}


def main(arguments: list[str] | None = None) -> int:
    """Exit code: 0 done, 2 records are absent or an example is not known."""
    parser = argparse.ArgumentParser(prog="python -m examples", description="Worked examples on measured records.")
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"some of: {', '.join(EXAMPLES)}")
    parser.add_argument("--data", type=Path, help="folder of the records")
    given = parser.parse_args(arguments)
    data = given.data or Path(os.environ.get("BAYEQ_DATA", ROOT.parent / "shared" / "data"))
    unknown = [name for name in given.names if name not in EXAMPLES]
    if unknown:
        print(f"no example is called {unknown[0]!r}; there are: {', '.join(EXAMPLES)}", file=sys.stderr)
        return 2
    chosen = {name: EXAMPLES[name] for name in given.names or EXAMPLES}
    absent = [module.FILE for module in chosen.values() if not (data / module.FILE).is_file()]
    if absent:
        print(
            f"measured records are absent: {', '.join(absent)} (looked in {data}); they are no part of bayeq: see the"
            " sources in docs/examples.md, and set BAYEQ_DATA or --data to the folder that holds them",
            file=sys.stderr,
        )
        return 2
    done = []
    for name, module in chosen.items():
        print(f"{name} ...", file=sys.stderr, flush=True)
        example = Example(name)
        module.run(example, data)
        done.append(example)
    if given.names:
        for example in done:
            print("\n\n".join(example.blocks.values()))
        return 0
    PAGE.write_text(put_blocks(PAGE.read_text(encoding="utf-8"), done), encoding="utf-8")
    write_table(done, DOCS / "tables" / "examples.csv")
    for example in done:
        assert example.figure is not None
        write_figure(example.figure, DOCS / "figures" / f"example_{example.name}.png")
    return 0


if __name__ == "__main__":
    sys.exit(main())
