"""Every registered estimator in C: the bits of the corrector, whatever the stream."""

import ctypes
import re
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from sklearn.neighbors import KNeighborsRegressor
from tests.runtime.streams import faulty

from truejoint.calibration.interval import Interval
from truejoint.errors import TruejointError
from truejoint.export.export_c import export_c
from truejoint.runtime import Status

from ..runtime import streams
from ..runtime.registered import ALIKE, in_loop, model, ready, unseen_samples
from .library import (
    CPP,
    FLAGS,
    PLAIN,
    STRICT,
    Library,
    compile_c,
    expected,
    exported,
    needs_compiler,
)

LONGEST_FUNCTION = 80
HELD = {"linear", "poly2", "rich_play", "play_both", "lsm_intercept", "ukf_cables"}
"""Of the same lines of C as `poly2_ridge`, `rich_trees`, `play_motor`, `lsm` and `hybrid_cables`,
but for a sum of theirs."""
IN_C = [name for name in in_loop() if name not in ALIKE | HELD]
IN_FLOAT = [
    "dnn", "rich_trees", "gp_lowpass", "gru", "tcn", "lsm_compensated",
    "ukf_compensated", "play_gated", "ukf_friction", "ukf_elastic", "hybrid_cables",
]  # fmt: skip
"""One for each arithmetic; what stacks, banks and hybrids sum is in these."""


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    """Each estimator exported and compiled once for each precision."""
    built: dict[tuple[str, str], Library] = {}

    def build(name: str, precision: str = "double") -> Library:
        if (name, precision) not in built:
            folder = tmp_path_factory.mktemp(f"{name}_{precision}")
            built[name, precision] = exported(folder, model(name), precision)
        return built[name, precision]

    return build


def stream(name: str, n: int, seed: int):
    """Stamps and samples of a motion that the estimator was not fitted to, with faults."""
    _, recording, samples = unseen_samples(name, n)
    return faulty(recording.t, samples, seed)


def compare(library: Library, calibration, name: str, compare_arrays, seed: int = 3):
    """Compare C and corrector on a broken stream; returns the statuses."""
    t, samples = stream(name, 1500, seed)
    samples = samples.astype(library.dtype).astype(float)
    library.functions.start()
    given = library.run(t, samples, len(calibration.joints))
    wanted = expected(ready(calibration), t, samples)
    np.testing.assert_array_equal(given[0], wanted[0])
    for got, want in zip(given[1:], wanted[1:], strict=True):
        compare_arrays(got, want)
    return wanted[0]


@needs_compiler
@pytest.mark.parametrize("name", IN_C)
def test_a_broken_stream_gives_the_same_bits(library, name):
    statuses = compare(library(name), model(name), name, np.testing.assert_array_equal)
    assert 0.2 < (statuses == 0).mean() < 1.0
    assert np.bitwise_or.reduce(statuses) & (Status.NOT_FINITE | Status.STALE)


@needs_compiler
@pytest.mark.parametrize("name", IN_C)
def test_the_source_passes_its_own_check_and_is_good_to_read(library, name):
    assert library(name).functions.check() == 0
    header = (library(name).folder / "m.h").read_text()
    assert f" RAM: {library(name).functions.ram()} bytes for each state." in header
    source = (library(name).folder / "m.c").read_text()
    assert not re.search(r"\b(numbers|memory)\s*\[", source)
    assert max(map(len, source.splitlines())) <= 100
    assert not re.search(r"\b(malloc|calloc|realloc|alloca)\b", source)
    for function in re.findall(r"^\{\n(.*?)^\}", source, re.MULTILINE | re.DOTALL):
        assert function.count("\n") <= LONGEST_FUNCTION


@needs_compiler
@pytest.mark.parametrize("name", ["dnn", "ukf_friction"])
def test_optimised_as_users_do_it_differs_in_the_last_bits_only(library, name):
    def close(got, want):
        np.testing.assert_allclose(got, want, rtol=0, atol=1e-12)

    optimised = Library(library(name).folder, flags=("-O2",))
    compare(optimised, model(name), name, close)


def with_interval(plain, rezero: float):
    """Calibration that states an interval, which holds after so many seconds of truth."""
    widths = np.full((1, len(plain.joints)), 0.003)
    return replace(plain, interval=Interval(np.array([0.9]), widths, 2.0, rezero, 12, 12))


def with_moved_zero(plain, shift: float):
    """Calibration of which the zero of all inputs and outputs has moved."""
    domain = plain.training_domain
    spans = (domain.signal_upper - domain.signal_lower)[: len(plain.signals)]
    moves = np.tile(spans[:, None], len(plain.joints))
    moved = replace(plain, moves=moves).shifted(np.full(len(plain.joints), shift))
    assert moved.signal_shift.any()
    return moved


@needs_compiler
@pytest.mark.parametrize(("name", "rezero"), [("dnn", 0.0), ("ukf_elastic", 10.0)])
def test_an_interval_and_a_zero_that_moved_are_in_the_source(tmp_path, name, rezero):
    """Of one without a width of its own and at once, of one with, and not before a new zero."""
    calibration = with_interval(with_moved_zero(model(name), 0.02), rezero)
    library = exported(tmp_path, calibration)
    assert library.functions.check() == 0
    compare(library, calibration, name, np.testing.assert_array_equal)


@needs_compiler
@pytest.mark.parametrize("name", IN_FLOAT)
def test_single_precision_is_no_further_off_than_its_header_says(library, name):
    single = library(name, "float")
    assert single.functions.check() == 0
    stated = float(re.search(r"within (\S+) \(rad", (single.folder / "m.h").read_text())[1])
    calibration, recording, samples = unseen_samples(name, 1500)
    samples = samples.astype(np.float32).astype(float)
    single.functions.start()
    status, position, half_width, _ = single.run(recording.t, samples, len(calibration.joints))
    wanted = expected(ready(calibration), recording.t, samples)
    assert (status != wanted[0]).mean() < 0.02  # a sample on a limit may be judged differently
    good = (status == 0) & (wanted[0] == 0)
    off = np.abs(position - wanted[1])[good].max()
    assert 1e-10 < off <= stated < 1e-4
    if np.isfinite(wanted[2][good]).all():
        np.testing.assert_allclose(half_width[good], wanted[2][good], rtol=0, atol=stated)


@needs_compiler
@pytest.mark.parametrize("name", ["rich_trees", "ukf_friction"])
def test_reset_forgets_the_history(library, name):
    (t, samples), made, n = stream(name, 600, 1), library(name), len(model(name).joints)
    made.functions.start()
    fresh = made.run(t[300:], samples[300:], n)
    assert (fresh[0] == 0).any()
    made.functions.start()
    made.run(t[:300], samples[:300], n)
    made.functions.forget_all()
    for one, other in zip(fresh, made.run(t[300:], samples[300:], n), strict=True):
        np.testing.assert_array_equal(one, other)


@needs_compiler
@pytest.mark.skipif(CPP is None, reason="no C++ compiler on this machine")
@pytest.mark.parametrize(
    ("name", "precision"), [("ukf_elastic", "double"), ("dnn", "float")],
)  # fmt: skip
def test_it_is_cpp_too(library, name, precision):
    source = library(name, precision).folder / "m.c"
    flags = ("-x", "c++", "-std=c++17", *STRICT, "-fsyntax-only")
    subprocess.run([CPP, *flags, str(source)], check=True)  # noqa: S603  # our own


def test_an_estimator_that_only_works_offline_is_refused_in_one_line(tmp_path):
    offline = streams.trained(KNeighborsRegressor(algorithm="brute"))
    with pytest.raises(TruejointError, match="cannot run in a loop") as caught:
        export_c(offline, tmp_path)
    assert "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())


LOADS = """
#include "m.h"
void loads(int n, const double *t, const double *sample, double *load);
void loads(int n, const double *t, const double *sample, double *load)
{
    m_state state;
    double position[M_JOINTS], half_width[M_JOINTS];

    m_init(&state);
    m_set_homing(&state, 1, M_HOMING_OF_CALIBRATION);
    for (int i = 0; i < n; i++) {
        m_step(&state, t[i], sample + i * M_SIGNALS, position, half_width);
        load[2 * i] = state.model.load[0];
        load[2 * i + 1] = state.model.load[1];
    }
}
"""


@needs_compiler
def test_what_is_told_beside_the_position_stands_in_the_state(library):
    """It is a field of the state, of the same bits."""
    folder, (calibration, recording, samples) = (
        library("ukf_friction").folder, unseen_samples("ukf_friction", 800)
    )  # fmt: skip
    (folder / "loads.c").write_text(LOADS, encoding="ascii")
    compile_c([folder / "loads.c", folder / "library0.so"], folder / "loads.so", *FLAGS, *PLAIN)
    t, samples, given = np.array(recording.t), samples.copy(), np.empty((len(samples), 2))
    arrays = (a.ctypes.data_as(ctypes.c_void_p) for a in (t, samples, given))
    ctypes.CDLL(str(folder / "loads.so")).loads(len(t), *arrays)
    np.testing.assert_array_equal(given, ready(calibration).run(recording).beside["load"])
    assert np.ptp(given[:, 0]) > 0.0
