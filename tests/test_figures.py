"""Figures: what they show is computed rightly, and they are files that one can print, the same every time."""

from __future__ import annotations

import sys
import xml.etree.ElementTree as ET
from dataclasses import replace
from functools import partial
from itertools import combinations, pairwise

import numpy as np
import pytest

from bayeq.errors import InputError, MissingExtraError, UnknownNameError
from bayeq.figures.style import FULL_WIDTH, PALE, SINGLE_COLUMN, mathtext, save, style
from bayeq.study.config import StudyConfig
from bayeq.study.figures import (
    JointPosterior,
    compare,
    confidence_ellipse,
    draw_inclusion,
    draw_joint,
    joint_posterior,
    write_figures,
)

CHOSEN = ["duffing", "coulomb"]
SHORT = StudyConfig(perturb=0.0, samples=600, burn_in=100)
PNG = b"\x89PNG\r\n\x1a\n"


@pytest.fixture(scope="module")
def coulomb():
    return compare("coulomb", SHORT)


@pytest.fixture(scope="module")
def duffing():
    return compare("duffing", SHORT)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    folder = tmp_path_factory.mktemp("figures") / "new"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("bayeq.study.figures.StudyConfig", partial(StudyConfig, samples=600, burn_in=100))
        return write_figures(folder, systems=CHOSEN)


def width_in_mm(path):
    matplotlib_image = pytest.importorskip("matplotlib.image")
    return matplotlib_image.imread(path).shape[1] / 300 * 25.4


def test_files_of_both_figures(written):
    assert [path.name for path in written] == [
        "fig4_inclusion.png",
        "fig4_inclusion.svg",
        "fig5_joint.png",
        "fig5_joint.svg",
    ]
    for path in written:
        assert path.stat().st_size < 2_000_000
        if path.suffix == ".svg":
            assert ET.parse(path).getroot().tag == "{http://www.w3.org/2000/svg}svg"
            assert b"<dc:date>" not in path.read_bytes()
        else:
            assert path.read_bytes().startswith(PNG)
            assert width_in_mm(path) == pytest.approx(FULL_WIDTH, abs=0.2)


def test_same_seed_same_bytes_whatever_the_caller_has_set(written, tmp_path, monkeypatch):
    matplotlib = pytest.importorskip("matplotlib")
    monkeypatch.setattr("bayeq.study.figures.StudyConfig", partial(StudyConfig, samples=600, burn_in=100))
    with matplotlib.rc_context({"font.size": 31.0, "lines.linewidth": 7.0, "savefig.bbox": "tight"}):
        again = write_figures(tmp_path, systems=CHOSEN)
    assert [path.read_bytes() for path in again] == [path.read_bytes() for path in written]


def test_a_single_system_fits_a_column_and_the_linear_one_has_no_fig_5(tmp_path, monkeypatch):
    monkeypatch.setattr("bayeq.study.figures.StudyConfig", partial(StudyConfig, samples=600, burn_in=100))
    paths, others = (write_figures(tmp_path / str(seed), seed=seed, systems=["linear"]) for seed in (3, 4))
    assert [path.name for path in paths] == ["fig4_inclusion.png", "fig4_inclusion.svg"]
    assert all(a.read_bytes() != b.read_bytes() for a, b in zip(paths, others, strict=True))


def test_the_settings_of_the_caller_are_left_alone():
    matplotlib = pytest.importorskip("matplotlib")
    with matplotlib.rc_context({"font.size": 31.0}):
        with style():
            assert matplotlib.rcParams["font.size"] == 7.5
        assert matplotlib.rcParams["font.size"] == 31.0


def test_the_ellipse_holds_its_share():
    rng = np.random.default_rng(0)
    mean, covariance = np.array([3.0, -1e5]), np.array([[4.0, -900.0], [-900.0, 2.5e5]])
    cloud = rng.multivariate_normal(mean, covariance, size=200_000)
    for level in (0.5, 0.95):
        path = pytest.importorskip("matplotlib.path").Path(confidence_ellipse(mean, covariance, level).T)
        share = path.contains_points(cloud).mean()
        assert share == pytest.approx(level, abs=4 * np.sqrt(level * (1 - level) / len(cloud)) + 2e-4)


def test_the_ellipse_lies_on_the_quantile():
    covariance = np.array([[2.0, 1.2], [1.2, 1.0]])
    off = confidence_ellipse([1.0, 2.0], covariance) - np.array([[1.0], [2.0]])
    distance = np.einsum("in,ij,jn->n", off, np.linalg.inv(covariance), off)
    np.testing.assert_allclose(distance, 5.991464547107979, rtol=1e-12)  # chi-square table, 2 dof, 0.95


def test_what_fig_4_shows(coulomb):
    to_hex = pytest.importorskip("matplotlib.colors").to_hex
    with style():
        (ax,) = draw_inclusion([coulomb]).axes
    terms = [label.get_text() for label in ax.get_yticklabels()]
    assert len(terms) == 36
    true = [patch for patch in ax.patches if to_hex(patch.get_facecolor()) == PALE.lower()]
    assert [terms[round(patch.get_y() + 0.5)] for patch in true] == ["$x$", "$v$", r"$\mathrm{sgn}(v)$", "$u$"]
    mcmc, vb = ([bar.get_width() for bar in bars] for bars in ax.containers)
    np.testing.assert_array_equal(mcmc, coulomb.mcmc.pip)
    np.testing.assert_array_equal(vb, coulomb.vb.pip)


def test_what_fig_5_shows(coulomb):
    joint = joint_posterior(coulomb)
    names = list(coulomb.vb.names)
    true = [names.index(name) for name in ("x", "v", "sign(v)", "u")]
    np.testing.assert_allclose(joint.truth, [-1000.0, -2.0, -1.0, 1.0])
    np.testing.assert_allclose(joint.vb_mean, coulomb.vb.coef[true])
    assert joint.labels[2] == "$\\mathrm{sgn}(v)$:  $-c_{F}/m$\n[m s$^{-2}$]"
    assert joint.samples.shape == joint.included.shape == (4 * 500, 4)
    assert np.all((joint.samples != 0) == joint.included)
    assert np.all(joint.included[joint.same_model])
    assert sorted(joint.ellipses) == [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]
    # an ellipse reaches sqrt(5.99) standard deviations to each side
    half = np.ptp(joint.ellipses[0, 2], axis=1) / 2
    np.testing.assert_allclose(half, np.sqrt(5.9915) * coulomb.vb.sd[[true[0], true[2]]], rtol=1e-3)
    assert np.all((joint.limits[:, 0] < joint.truth) & (joint.truth < joint.limits[:, 1]))


def test_large_coefficients_are_given_in_powers_of_ten(duffing):
    joint = joint_posterior(duffing)
    assert joint.labels[2] == "$x^{3}$:  $-k_{3}/m$\n[$10^{5}$ m$^{-2}$ s$^{-2}$]"
    assert joint.labels[3] == "$u$:  $1/m$\n[kg$^{-1}$]"
    assert joint.truth[2] == -1.0
    assert joint.vb_mean[2] == pytest.approx(-1.0, abs=0.1)


def test_a_term_that_vb_leaves_out_has_no_ellipse(coulomb):
    vb = coulomb.vb
    j = vb.names.index("sign(v)")
    row = int(np.count_nonzero(vb.support[:j]))
    support = vb.support.copy()
    support[j] = False
    without = replace(
        vb,
        support=support,
        coef=np.where(support, vb.coef, 0.0),
        covariance=np.delete(np.delete(vb.covariance, row, 0), row, 1),
    )
    joint = joint_posterior(replace(coulomb, vb=without))
    assert sorted(joint.ellipses) == [(0, 1), (0, 3), (1, 3)]
    np.testing.assert_array_equal(joint.ellipses[1, 3], joint_posterior(coulomb).ellipses[1, 3])


def few(n, ellipses):
    rng = np.random.default_rng(1)
    return JointPosterior(
        title="two coefficients",
        labels=("a", "b"),
        names=("$x$", "$v$"),
        samples=rng.standard_normal((n, 2)),
        included=np.ones((n, 2), dtype=bool),
        same_model=np.arange(n) % 2 == 0,
        truth=np.zeros(2),
        vb_mean=np.zeros(2),
        vb_included=np.array([True, bool(ellipses)]),
        ellipses=ellipses,
        limits=np.array([[-3.0, 3.0], [-3.0, 3.0]]),
    )


@pytest.mark.parametrize("n", [0, 50])
@pytest.mark.parametrize("systems", [1, 2])
def test_one_pair_and_empty_clouds(tmp_path, n, systems):
    panel = few(n, {(0, 1): confidence_ellipse([0, 0], np.eye(2))} if n else {})
    with style():
        png, svg = save(draw_joint([panel] * systems), tmp_path / "pair")
    assert width_in_mm(png) == pytest.approx(FULL_WIDTH if systems == 2 else SINGLE_COLUMN, abs=0.2)
    ET.parse(svg)


def test_a_panel_without_true_terms(coulomb):
    with style():
        figure = draw_inclusion([replace(coulomb, truth=np.zeros_like(coulomb.truth))])
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["SS-MCMC", "SS-VB", "PIP = 0.5"]


def test_nothing_is_clipped_or_overlaps(coulomb, duffing):
    """Texts lie inside the figure, and ticks' labels do not run into each other."""
    with style():
        for figure in (draw_inclusion([coulomb] * 2), draw_joint([joint_posterior(duffing)] * 2)):
            figure.draw_without_rendering()
            labels = [ax.xaxis.label.get_window_extent() for ax in figure.axes if ax.get_xlabel()]
            assert not any(a.overlaps(b) for a, b in combinations(labels, 2))
            for ax in figure.axes:
                box = ax.get_tightbbox()
                assert box.x0 >= 0
                assert box.y0 >= 0
                assert box.x1 <= figure.bbox.x1
                assert box.y1 <= figure.bbox.y1
                for axis in (ax.xaxis, ax.yaxis):
                    boxes = [label.get_window_extent() for label in axis.get_ticklabels() if label.get_text()]
                    assert not any(a.overlaps(b) for a, b in pairwise(boxes))


@pytest.mark.parametrize(
    ("term", "expected"),
    [
        ("x**2*v", "$x^{2} v$"),
        ("v*abs(x)", r"$v\,|x|$"),
        ("x2*abs(x2)", r"$x_{2}\,|x_{2}|$"),
        ("-c2/m", "$-c_{2}/m$"),
        ("1/m", "$1/m$"),
        ("x2-x1", "$x_{2} - x_{1}$"),
        ("(x2-x1)**3", r"$\left(x_{2} - x_{1}\right)^{3}$"),
        ("x1-x2", "$x_{1} - x_{2}$"),
        ("dN", "$dN$"),
    ],
)
def test_terms_as_they_are_set(term, expected):
    assert mathtext(term, order=("x", "v")) == expected


def test_without_matplotlib(monkeypatch, tmp_path):
    for name in [name for name in sys.modules if name.partition(".")[0] == "matplotlib"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(MissingExtraError, match=r"drawing figures needs matplotlib: .*bayeq\[plot\]"):
        write_figures(tmp_path / "none")
    assert not (tmp_path / "none").exists()


def test_wrong_arguments(tmp_path):
    with pytest.raises(UnknownNameError, match="duffing"):
        write_figures(tmp_path, systems=["dufing"])
    with pytest.raises(InputError, match="seed"):
        write_figures(tmp_path, seed=-1)
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot write the figure"):
        write_figures(tmp_path / "file", systems=["linear"])
