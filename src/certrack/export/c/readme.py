"""The README that goes with exported C code."""

from __future__ import annotations

from certrack.export.c.source import CCode
from certrack.export.program import unread

#: What every such file says.
KIND = "tracking controller in C99"


def readme(code: CCode, notes: tuple[str, ...]) -> str:
    """Contents of README.md."""
    implementation, name = code.system.implementation, code.name
    assert implementation is not None
    period = implementation.period
    derivatives = ", ".join(["y_d", *(f"y_d^({i})" for i in range(1, len(code.program.Y)))])
    idle = unread(code.system)
    states = ", ".join(f"{s} ({idle[s]})" if s in idle else s for s in code.system.plant.states)
    kept = ", ".join(code.members) if code.program.states else "nothing"
    warning = "".join(f"**Note:** {note}\n\n" for note in notes)
    return f"""# {name}: {KIND}

`{name}.h` and `{name}.c` are the controller, with `{code.real}` numbers, sampled every
{period!r} s. They need `<math.h>` only: no dynamic memory, no globals, no loops.

{warning}## Accept it

    gcc {name}.c {name}_test.c -lm && ./a.out

compares it with what certrack simulates and prints the worst deviation; the exit code is 0 if all
is well. Run this test on the target, too.

## Use it

```c
#include "{name}.h"

static {name}_state s;

void start(void)
{{
    {name}_init(&s);
}}

void every_period(const {name}_real x[{name}_STATES], const {name}_real y_d[{name}_REFERENCES])
{{
    set_actuator({name}_step(&s, x, y_d));
}}
```

| | |
|---|---|
| `x` | measured plant states: {states} |
| `y_d` | the reference and its derivatives, all at the time of the sample: {derivatives} |
| returned | the input u, to be held until the next one |
| kept in `{name}_state` | {kept} |

`{name}_output` gives u and changes nothing, `{name}_update` goes on to the next sample;
`{name}_step` does both at half the cost. Several controllers run side by side, each with a
`{name}_state` of its own.

## Mind

* Call it every {period!r} s. `{name}_PERIOD` is for reading: other numbers were computed from
  it, too. Export again for another period.
* Quantisers, noise and delay of the simulated drive are not in the code: the real one has its own.
* What is not a number stays so: check the measurements before you hand them over.
* sin, cos and tan of large arguments are slow on microcontrollers (range reduction) and inaccurate
  in float: keep angles within a few turns.
"""
