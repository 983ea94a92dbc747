from __future__ import annotations

import csv

from studies.coverage import main


def test_coverage_of_a_few_records(capsys):
    # with exact states a regression of the rows as measured tells as much
    main(["--records", "2", "--clean-states", "--smooth", "none"])
    rows = list(csv.DictReader(capsys.readouterr().out.splitlines()))
    assert {row["system"] for row in rows} == {"linear", "duffing", "quadratic", "coulomb"}
    assert all(0.9 < float(row["mean_ratio_to_truth"]) < 1.1 for row in rows)
