from __future__ import annotations

import csv

import numpy as np
import pytest
from studies.ablation import VARIANTS, _realise, literal_vb, main, run_ablation

import bayeq as bq
from bayeq.dictionary import Variables, build_dictionary, evaluate_terms
from bayeq.inference.rvm import rvm
from bayeq.inference.vb import spike_slab_vb
from bayeq.study.config import StudyConfig
from bayeq.study.realise import draw
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


def test_every_variant_changes_something_and_runs():
    assert len({(v.factor, v.change) for v in VARIANTS}) == len(VARIANTS)
    for variant in VARIANTS:
        gram, _ = _realise("linear", variant, (0, 0, 0))
        support = variant.select(gram)
        assert support.shape == (36,)
        assert support.dtype == bool
        assert support.any()


def test_the_command_prints_a_table_that_does_not_depend_on_the_jobs(capsys):
    main(["--realisations", "2", "--jobs", "2"])
    rows = list(csv.DictReader(capsys.readouterr().out.splitlines()))
    assert [row["change"] for row in rows] == [v.change for v in VARIANTS]
    assert rows == [dict(row) for row in run_ablation(2, jobs=1)]
