from __future__ import annotations

import csv

import numpy as np
import pytest
from studies.ablation import VARIANTS, _realise, literal_vb, main, run_ablation

import bayeq as bq
from bayeq.dictionary import Variables, build_dictionary, evaluate_terms
from bayeq.inference.rvm import rvm
from bayeq.inference.vb import spike_slab_vb
from bayeq.study.config import STUDY_SYSTEMS, StudyConfig
from bayeq.study.runner import draw
from tests import reference


@pytest.mark.parametrize("seed", range(4))
def test_the_literal_transcription_is_the_twin_and_the_engine(seed):
    record = bq.simulate("duffing", n=500, seed=seed)
    D = evaluate_terms(build_dictionary("oscillator", Variables(("x", "v"), ("u",))), record.channels)
    gram = bq.Gram.from_data(D, record["a"]).standardise().gram
    gram = gram.with_dof(gram.n)
    start = rvm(gram).pip
    w = literal_vb(gram, start)
    Z = (D - D.mean(axis=0)) / D.std(axis=0)
    twin = reference.vb(Z, record["a"] - record["a"].mean(), start, 1000.0)[0]
    np.testing.assert_allclose(w, twin, atol=1e-6)
    np.testing.assert_allclose(w, spike_slab_vb(gram, init="rvm").pip, atol=1e-6)


def test_realisations_are_those_of_the_study():
    gram, true = _realise("duffing", VARIANTS[0], (0, 1, 3))
    other = draw(StudyConfig(seed=0), "duffing", 3)
    np.testing.assert_allclose(gram.DtD, other.train.standardise().gram.DtD, rtol=1e-9, atol=1e-6)
    assert true == {"x", "v", "x**3", "u"}


def selected(variant, system, index):
    """Terms that a variant selects in a realisation of the study, and the true ones."""
    gram, true = _realise(system, variant, (0, STUDY_SYSTEMS.index(system), index))
    return {name for name, kept in zip(gram.names, variant.select(gram), strict=True) if kept}, true


def test_every_variant_changes_what_is_selected():
    # The first realisations on which the variants differ from what they vary. Most do on the first of all; all w_i
    # together, a target of unit variance and v_s = 1000 change hardly any (docs/tables/ablation.csv).
    looked_at = [("linear", 0), ("duffing", 0), ("quadratic", 3), ("coulomb", 4), ("quadratic", 6), ("coulomb", 6)]
    looked_at.append(("coulomb", 25))
    paper, search = VARIANTS[:2]
    for variant in VARIANTS[1:]:
        varied = search if variant.factor == "search" else paper
        assert any(selected(variant, *drawn) != selected(varied, *drawn) for drawn in looked_at), variant.change


def test_the_command_prints_a_table_that_does_not_depend_on_the_jobs(capsys):
    main(["--realisations", "2", "--jobs", "1"])
    rows = list(csv.DictReader(capsys.readouterr().out.splitlines()))
    assert [row["change"] for row in rows] == [v.change for v in VARIANTS]
    others = run_ablation(2, jobs=2)
    assert [dict(next(others)) for _ in rows[:3]] == rows[:3]
    others.close()
    for row, variant in zip(rows, VARIANTS, strict=True):
        answers = [selected(variant, "coulomb", index) for index in range(2)]
        assert float(row["coulomb_exact"]) == np.mean([found == true for found, true in answers])
        false = np.mean([len(found - true) / max(len(found), 1) for found, true in answers])
        assert float(row["coulomb_fdr"]) == pytest.approx(false, abs=5e-4)
