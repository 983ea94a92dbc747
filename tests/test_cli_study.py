from __future__ import annotations

import json

from bayeq.cli.app import main


def test_study_through_the_command(tmp_path, capsys):
    store = str(tmp_path / "study.db")
    size = ["--realisations", "2", "--jobs", "1", "--systems", "linear"]
    arguments = [*size, "--algorithms", "vb,rvm", "--store", store]
    assert main(["study", "table2", *arguments]) == 0
    assert "linear" in capsys.readouterr().out
    assert main(["study", "show", store, "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["rows"]
    assert [(r["system"], r["algorithm"], r["n"]) for r in rows] == [("linear", "rvm", 2), ("linear", "vb", 2)]
    assert {"e_theta_scaled", "e_theta", "e_p", "fdr", "exact", "superset", "seconds", "se", "paper"} <= set(rows[0])
    assert main(["study", "table2", *arguments, "--seed", "1"]) == 2
    assert capsys.readouterr().err.startswith("bayeq: error: ")
    assert main(["study"]) == 2
    assert "table2" in capsys.readouterr().err


def test_figures_through_the_command(tmp_path, capsys):
    assert main(["study", "figures", str(tmp_path / "out"), "--systems", "linear"]) == 0
    assert "fig4_inclusion.png" in capsys.readouterr().out
    assert (tmp_path / "out" / "fig4_inclusion.svg").is_file()
    assert main(["study", "figures", str(tmp_path), "--systems", "lineer"]) == 2
