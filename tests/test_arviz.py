from __future__ import annotations

import sys

import numpy as np
import pytest

from bayeq.adapters.arviz import convergence
from bayeq.errors import InputError, MissingExtraError
from bayeq.gram import Gram
from bayeq.inference.gibbs import spike_slab_gibbs
from tests import reference


def posterior(**options):
    D, y, _ = reference.random_problem(np.random.default_rng(1), n=200, P=5, rho=0.5, noise=0.5)
    return spike_slab_gibbs(Gram.from_data(D, y, list("abcde")), samples=1200, burn_in=200, **options)


def test_rank_rhat_and_effective_sample_sizes():
    pytest.importorskip("arviz")
    fit = posterior()
    table = convergence(fit)
    assert list(table.index) == [*"abcde", "noise_variance"]
    assert table.loc["noise_variance", "rhat"] < 1.02
    # sigma^2 is drawn afresh from its collapsed conditional: nearly independent, 4000 draws
    assert 2500 < table.loc["noise_variance", "ess_bulk"] < 6000
    assert (table.multivariate_rhat == fit.rhat).all()
    varying = fit.draws.theta.std(axis=(0, 1)) > 0
    assert table.rhat[:-1].notna().to_numpy().tolist() == varying.tolist()


def test_without_draws_or_without_arviz(monkeypatch):
    with pytest.raises(InputError, match="keep_draws"):
        convergence(posterior(keep_draws=False))
    monkeypatch.setitem(sys.modules, "arviz", None)
    with pytest.raises(MissingExtraError, match=r"bayeq\[arviz\]"):
        convergence(posterior())


def test_the_engine_does_not_import_arviz():
    import subprocess

    code = "import bayeq.inference.gibbs, sys; assert 'arviz' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)
