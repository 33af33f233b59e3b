"""The vector arithmetic of compiled ensembles, tricks with the bits of floats included."""

import ctypes
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
import sympy

import certrack
from certrack.core.lowering import numpy_callable
from certrack.core.select import Entry, Extremum
from certrack.integrators.registers import LANES
from certrack.studies.ensembles.statistics import (
    BAND_BINS,
    BAND_BITS,
    BINS_PER_SIDE,
    FINEST_OCTAVE,
    Bands,
)

COMPILER = shutil.which("gcc") or shutil.which("cc") or shutil.which("clang")
FLAGS = "-std=gnu11 -O3 -fno-math-errno -fno-trapping-math -fno-signed-zeros -shared -fPIC".split()
HEADER = next(Path(certrack.__file__).parent.rglob("vector_math.h"))

pytestmark = pytest.mark.skipif(COMPILER is None, reason="needs a C compiler")

SOURCE = r"""
#include "vector_math.h"
#define MAP(name, formula)                                           \
  void map_##name(double *a, long count) {                           \
    for (long i = 0; i < count; i += LANES) {                        \
      V v;                                                           \
      memcpy(&v, a + i, sizeof v);                                   \
      v = formula;                                                   \
      memcpy(a + i, &v, sizeof v);                                   \
    }                                                                \
  }
MAP(sin, v_sin(v))
MAP(cos, v_cos(v))
MAP(exp, v_exp(v))
MAP(log, v_log(v))
MAP(abs, v_abs(v))
MAP(sign, v_sign(v))
MAP(sqrt, v_sqrt(v))
MAP(rounded, rounded(v, 0.25))
MAP(rough_inverse, rough_inverse(v))
MAP(any, SPLAT(any(v > SPLAT(0.0)) ? 1.0 : 0.0))
MAP(select, greater(v, SPLAT(1.0), v_max(v, SPLAT(2.0)), v_min(v, SPLAT(-1.0))))

int lanes(void) { return LANES; }
static V column(const double *table, int row, long count, long i) {
  V v;
  memcpy(&v, table + row * count + i, sizeof v);
  return v;
}
void map_extremum(const double *a, double *out, long n) {
  for (long i = 0; i < n; i += LANES) {
    V v = v_Extremum(column(a, 0, n, i), column(a, 1, n, i), column(a, 2, n, i),
                     column(a, 3, n, i));
    memcpy(out + i, &v, sizeof v);
  }
}
void map_entry(const double *a, double *out, long n, double band) {
  for (long i = 0; i < n; i += LANES) {
    V v = v_Entry(column(a, 0, n, i), column(a, 1, n, i), column(a, 2, n, i), column(a, 3, n, i),
                  SPLAT(band));
    memcpy(out + i, &v, sizeof v);
  }
}
void map_bins(const float *a, uint16_t *out, long n, int side, int bits) {
  for (long i = 0; i < n; i += LANES) {
    F v;
    memcpy(&v, a + i, sizeof v);
    H bins = bins_of(v, i < n - LANES ? ~(I){0} : (I){0}, side, bits);
    memcpy(out + i, &bins, sizeof bins);
  }
}
"""


@pytest.fixture(scope="module", params=["-march=native", "-mtune=generic"])
def library(request, tmp_path_factory):
    """The header compiled for this processor, and without any of its special instructions."""
    folder = tmp_path_factory.mktemp("vector")
    (folder / "vector_math.h").write_text(HEADER.read_text())
    (folder / "shim.c").write_text(SOURCE)
    command = [COMPILER, *FLAGS, request.param, "shim.c", "-o", "shim.so", "-lm"]
    subprocess.run(command, cwd=folder, check=True, capture_output=True)
    return ctypes.CDLL(str(folder / "shim.so"))


def pointer(array):
    return ctypes.c_void_p(array.ctypes.data)


def mapped(library, name, values):
    """The values of a function, a register at a time."""
    count = len(values)
    padded = np.append(np.array(values, dtype=float), np.zeros(-count % 8))
    getattr(library, f"map_{name}")(pointer(padded), ctypes.c_long(len(padded)))
    return padded[:count]


RANDOM = np.random.default_rng(7)
EDGES = [0.0, 5e-324, 1e-310, 2.3e-308, 1e-300, 1e-16, 0.5, 1.0, np.pi / 2, np.pi, 1e5, 1e22]
EDGES = np.array([*EDGES, *(-x for x in EDGES), 699.9, 700.1, -745.0, 1e301, np.inf, np.nan])


@pytest.mark.parametrize(
    ("name", "values", "rtol", "atol"),
    [
        ("sin", RANDOM.uniform(-1e5, 1e5, 20_000), 0, 1e-15),
        ("cos", RANDOM.uniform(-1e5, 1e5, 20_000), 0, 1e-15),
        ("sin", RANDOM.uniform(-0.1, 0.1, 20_000), 1e-15, 0),
        ("exp", RANDOM.uniform(-700, 700, 20_000), 1e-15, 0),
        ("log", 10 ** RANDOM.uniform(-300, 300, 20_000), 1e-15, 3e-15),
        ("log", RANDOM.uniform(0.5, 2, 20_000), 0, 3e-15),
    ],
)
def test_elementary_functions(library, name, values, rtol, atol):
    exact = getattr(np, name)(values)
    np.testing.assert_allclose(mapped(library, name, values), exact, rtol=rtol, atol=atol)


@pytest.mark.parametrize("name", ["sin", "cos", "exp", "log", "abs", "sqrt", "sign"])
def test_edges_of_the_range(library, name):
    """Beyond the range of the series the C library's functions take over, lane by lane."""
    with np.errstate(all="ignore"):
        exact = getattr(np, name)(EDGES)
    usual = ~np.isnan(EDGES) | (name != "sign")  # v_sign of what is not a number is zero
    values = mapped(library, name, EDGES)
    np.testing.assert_allclose(values[usual], exact[usual], rtol=1e-15, atol=3e-15)


def test_rounding_to_a_quantum(library):
    """To the nearest multiple, ties to even, as NumPy does; huge and strange values stay."""
    values = np.concatenate(
        [
            np.arange(-40, 41) / 16,
            RANDOM.uniform(-1e6, 1e6, 1000),
            2.0**49 * np.array([0.9, 1.1, 1024.0]),
            [np.inf, -np.inf, np.nan],
        ]
    )
    np.testing.assert_array_equal(mapped(library, "rounded", values), np.rint(values / 0.25) * 0.25)


def test_selections(library):
    values = np.array([-3.0, -0.5, 0.0, 1.0, 1.5, 3.0, np.inf, np.nan])
    expected = [-3.0, -1.0, -1.0, -1.0, 2.0, 3.0, np.inf, -1.0]
    np.testing.assert_array_equal(mapped(library, "select", values), expected)
    for lane in range(8):
        one = np.full(8, -1.0)
        assert mapped(library, "any", one)[0] == 0.0
        one[lane] = 1.0
        assert mapped(library, "any", one)[0] == 1.0


def test_registers_are_as_long_as_python_takes_them_for(library):
    assert library.lanes() == LANES


def test_rough_inverse(library):
    values = np.concatenate([RANDOM.uniform(-10, 10, 1000), 10 ** RANDOM.uniform(-300, 300, 1000)])
    np.testing.assert_allclose(mapped(library, "rough_inverse", values), 1 / values, rtol=2.0**-14)


def test_cubics_are_those_of_the_formulas(library):
    """`Extremum` and `Entry` of core/select.py, where the place is known to 14 bits only."""
    names = sympy.symbols("e0 e1 d0 d1", real=True)
    table = RANDOM.normal(size=(4, 8000))
    table[2:, :100] = 0.0  # flat at both ends: nothing to divide by
    table[1, 100:200] = table[0, 100:200]
    count, out = table.shape[1], np.empty(table.shape[1])
    arguments = pointer(table), pointer(out), ctypes.c_long(count)
    extremum, entry = numpy_callable([names], [Extremum(*names), Entry(*names, 0.5)])(table)
    library.map_extremum(*arguments)
    scale = 1 + np.abs(table).max(axis=0)
    assert np.quantile(np.abs(out - extremum), 0.9) < 1e-5
    assert (np.abs(out - extremum) < 1e-2 * scale).all()
    library.map_entry(*arguments, ctypes.c_double(0.5))
    assert ((out >= 0) & (out <= 1)).all()
    rises = table[0] != table[1]  # otherwise nothing enters, and the place is not used
    assert np.quantile(np.abs(out - entry)[rises], 0.99) < 1e-4
    assert (np.abs(out - entry)[rises] < 1e-2).all()


def test_bins_are_those_of_the_statistics(library):
    """The same integers as `Bands.observe`, from the leading bits of a float."""
    values = np.concatenate(
        [
            RANDOM.normal(size=4000) * 10 ** RANDOM.uniform(-6, 9, 4000),
            2.0 ** np.arange(-20, 100),
            -(2.0 ** np.arange(-20, 100)),
            [0.0, 1e30, -1e30, np.inf, -np.inf, np.nan],
        ]
    ).astype(np.float32)
    values = np.append(values, np.ones(-len(values) % 8, dtype=np.float32))
    padded = np.append(values, np.ones(8, dtype=np.float32))  # members that are not alive
    bins = np.empty(len(padded), dtype=np.uint16)
    library.map_bins(
        pointer(padded), pointer(bins), ctypes.c_long(len(padded)), BINS_PER_SIDE, BAND_BITS
    )
    assert (bins[-8:] == BAND_BINS - 1).all()
    for value, bin_ in zip(values, bins, strict=False):
        bands = Bands(np.zeros((1, 1)), np.array([2.0**FINEST_OCTAVE]))
        bands.observe(0, 0, np.array([float(value)]))
        assert bands.counts[0, 0].argmax() == bin_
