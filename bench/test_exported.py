"""A step of the exported C, in double precision, against the law written by hand: `make bench`.

Both are functions of a file of their own, called from a loop in another, with measurements that
change and with the state carried along, as a drive calls them.
"""

import subprocess

import numpy as np
import pytest

import certrack
from certrack.core.compilers import find_c_compiler

#: Steps of a program, calls of each candidate in turns, and the ratio that is wanted.
STEPS, ROUNDS, WANTED = 2_000_000, 9, 1.4

#: The laws with every constant folded by hand: state in, state out.
BY_HAND = {
    "example1": """
        double phi = 1.0 + x[0] * sin(x[1]);
        double e = 1.75 * x[0] + x[1] - 3.25 * y[0];
        double ubar = 7.73828125 * y[0] + 3.25 * y[1]
            + x[0] * (0.16015625 - x[0] * x[1]) - 5.265625 * x[1] - s[1] * phi;
        double u = s[0] * ubar;
        s[0] += 0.001 * (0.6 * (0.4 - s[0]) - e * ubar);
        s[1] += 0.001 * (phi * e + 0.6 * (2.1 - s[1]));
        return u;
    """,
    "dual-motor-lean": """
        (void)s;
        return 27.304166666666667 * y[0] + 10.9 * y[1] + 1.0541666666666667 * y[2]
            - 11.304166666666667 * x[0] - 9.7 * x[1] - 16.0 * x[2] - 1.2 * x[3];
    """,
}

MAIN = """
#include "{stem}.h"
#include <stdio.h>
#include <time.h>
double by_hand(double *s, const double *x, const double *y);
static double now(void) {{
    struct timespec t;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return t.tv_sec + 1e-9 * t.tv_nsec;
}}
int main(void) {{
    static double table[64][8];
    for (int i = 0; i < 64; i++)
        for (int j = 0; j < 8; j++) table[i][j] = 0.01 * ((7 * i + 3 * j) % 19) - 0.09;
    double best[2] = {{1e9, 1e9}}, sums[2];
    for (int turn = 0; turn < {rounds}; turn++) {{
        {stem}_state state;
        double s[4] = {{0}}, begin = now();
        {stem}_init(&state);
        sums[0] = sums[1] = 0.0;
        for (int i = 0; i < {steps}; i++)
            sums[0] += {stem}_step(&state, table[i % 64], table[i % 64] + 4);
        double between = now();
        for (int i = 0; i < {steps}; i++)
            sums[1] += by_hand(s, table[i % 64], table[i % 64] + 4);
        double spent[2] = {{between - begin, now() - between}};
        for (int j = 0; j < 2; j++) best[j] = spent[j] < best[j] ? spent[j] : best[j];
    }}
    printf("%.17g %.17g %.17g %.17g\\n", best[0], best[1], sums[0], sums[1]);
}}
"""


@pytest.mark.parametrize("name", sorted(BY_HAND))
def test_step(name, tmp_path, report):
    stem = name.replace("-", "_")
    certrack.export_c(certrack.load(name), tmp_path, name=stem, period=0.001)
    hand = "#include <math.h>\ndouble by_hand(double *s, const double *x, const double *y) {"
    (tmp_path / "hand.c").write_text(hand + BY_HAND[name] + "}\n")
    main = MAIN.format(stem=stem, rounds=ROUNDS, steps=STEPS)
    (tmp_path / "main.c").write_text(main)
    program = tmp_path / "program"
    sources = [tmp_path / file for file in (f"{stem}.c", "hand.c", "main.c")]
    compiler = find_c_compiler()
    subprocess.run([compiler, "-O2", "-o", program, *sources, "-lm"], check=True)
    *times, ours, theirs = map(float, subprocess.check_output([program], text=True).split())
    np.testing.assert_allclose(ours, theirs, rtol=1e-9)
    exported, by_hand = (1e9 * time / STEPS for time in times)
    report(
        f"{name}: {exported:.2f} ns a step exported, {by_hand:.2f} by hand, "
        f"{exported / by_hand:.2f} times as long, wanted {WANTED}"
    )
