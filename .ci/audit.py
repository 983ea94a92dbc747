"""Known vulnerabilities of the packages that ``constraints.txt`` pins, by pip-audit: ``python .ci/audit.py``.

Exit code 0 if every package was looked up and none has any, 1 if one has, 2 if not all could be looked up.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

PINNED = Path(__file__).resolve().parents[1] / "constraints.txt"


def verdict(found: list[dict[str, Any]]) -> tuple[int, str]:
    """Exit code and one line, of the packages in pip-audit's answer."""
    weak = [f"{p['name']} {p['version']} ({', '.join(v['id'] for v in p['vulns'])})" for p in found if p.get("vulns")]
    if weak:
        return 1, f"{len(weak)} of {len(found)} packages have known vulnerabilities: {'; '.join(weak)}"
    unknown = [p["name"] for p in found if "skip_reason" in p]
    if unknown or not found:
        return 2, f"{len(unknown)} of {len(found)} packages could not be looked up: is the network there?"
    return 0, f"{len(found)} packages, no known vulnerability"


def main(command: list[str]) -> int:
    """Run pip-audit, by `command`, and print what it found in one line."""
    asked = [*command, "--requirement", str(PINNED), "--no-deps", "--disable-pip", "--format", "json"]
    asked += ["--progress-spinner", "off"]
    try:
        ended = subprocess.run(asked, capture_output=True, text=True, check=False, timeout=600)
        code, line = verdict(json.loads(ended.stdout)["dependencies"])
    except (OSError, subprocess.TimeoutExpired):
        code, line = 2, f"{command[0]} cannot be run; install pip-audit or uv"
    except (ValueError, KeyError):
        last = [text for text in ended.stderr.splitlines() if text.strip()] or ["no answer"]
        code, line = 2, f"pip-audit gave no answer: {last[-1].strip()[:200]}"
    print(f"audit: {line}", file=sys.stderr if code else sys.stdout)
    return code


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:] or ["uvx", "pip-audit"]))
