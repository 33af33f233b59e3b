"""The optional monitor of a function block: ENABLE, resets, and a flag for every premise."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import sympy

from certrack.export.monitor import COMMAND_BEFORE, HELD, Flag, MonitorProgram, Within
from certrack.export.program import ControllerProgram
from certrack.export.st.guard import finite_conditions
from certrack.export.st.statements import (
    INDENT,
    Statements,
    Variables,
    declaration,
    st_literal,
    unused_name,
)
from certrack.loops.controller import COMMAND

#: Inputs of a monitored block -> what they are for.
MONITOR_INPUTS = {
    "ENABLE": "the loop is closed",
    "RESET": "start again with all states",
    "RESET_ESTIMATES": "start again with the estimates",
    "CLEAR_FLAGS": "forget the latched flags",
}

#: The output that is TRUE while no flag is latched.
PREMISES_HOLD = "premises_hold"


@dataclass(frozen=True)
class BlockMonitor:
    """The monitor of a block.

    Attributes
    ----------
    program : ControllerProgram
    monitor : MonitorProgram
    names : mapping
        Identifiers of the block's symbols.
    flags : mapping
        Identifier of every flag, and that of its latch.
    followed : mapping
        Identifier that stands for y_d and each derivative in the law.
    """

    program: ControllerProgram
    monitor: MonitorProgram
    names: Mapping[sympy.Symbol, str]
    flags: Mapping[str, tuple[str, str]]
    followed: Mapping[sympy.Symbol, str]

    @classmethod
    def of(
        cls,
        program: ControllerProgram,
        monitor: MonitorProgram,
        names: Mapping[sympy.Symbol, str],
        used_names: set[str],
    ) -> BlockMonitor:
        """A monitor with identifiers of its own, which are used from now on."""
        flags = {
            flag.name: (
                unused_name(flag.name, used_names),
                unused_name(f"{flag.name}_latched", used_names),
            )
            for flag in monitor.flags
        }
        followed = {y: names[y] for y in program.Y}
        if monitor.limit_reference:
            followed = {y: unused_name(f"{names[y]}_limited", used_names) for y in program.Y}
        return cls(program, monitor, names, flags, followed)

    @property
    def law_names(self) -> dict[sympy.Symbol, str]:
        """Identifiers as the law reads them."""
        return {**self.names, **self.followed}

    @property
    def limited(self) -> tuple[str, ...]:
        """Temporary variables of the limited reference."""
        return tuple(self.followed.values()) if self.monitor.limit_reference else ()

    def inputs(self) -> list[str]:
        """Declarations of its inputs: parameters first."""
        note = "parameter: another value voids the certificate"
        constants = self.program.constants
        return [
            *(declaration(self.names[c], constants[c], note) for c in self.program.parameters),
            *(declaration(name, note=text, kind="BOOL") for name, text in MONITOR_INPUTS.items()),
        ]

    def outputs(self) -> list[str]:
        """Declarations of its outputs."""
        lines = [declaration(PREMISES_HOLD, note="no flag is latched", kind="BOOL := TRUE")]
        for flag in self.monitor.flags:
            now, latched = self.flags[flag.name]
            lines += [
                declaration(now, note=flag.meaning, kind="BOOL"),
                declaration(latched, note="was so while enabled", kind="BOOL"),
            ]
        return lines

    def statements(
        self, inputs: Sequence[str], saved: Mapping[str, str], law: Sequence[str]
    ) -> list[str]:
        """What a call does: `law` behind the guard, then what a disabled block undoes, then flags.

        Parameters
        ----------
        inputs : identifiers
            What the law reads.
        saved : mapping
            Output and states, and the temporary variable that keeps each of them meanwhile.
        law : statements
        """
        held, _ = self.flags[HELD]
        tests = finite_conditions(list(saved))
        return [
            *self._reset_estimates(),
            *self._limiter(),
            "",
            "(* a sample that is not finite holds the last u and all states *)",
            *(f"{saved_name} := {name};" for name, saved_name in saved.items()),
            f"{held} := TRUE;",
            "IF",
            *_joined(finite_conditions(inputs), "AND"),
            "THEN",
            *(INDENT + line if line else "" for line in law),
            f"{INDENT}{held} := NOT (",
            *(INDENT + line for line in _joined(tests, "AND")),
            f"{INDENT});",
            f"{INDENT}IF {held} THEN",
            *(f"{INDENT * 2}{name} := {saved_name};" for name, saved_name in saved.items()),
            f"{INDENT}END_IF;",
            "END_IF;",
            *self._disabled(saved),
            *self._judged(saved),
        ]

    def _reset_estimates(self) -> list[str]:
        restarted = self.monitor.restarted.items()
        lines = [f"{INDENT}{self.names[z]} := {st_literal(value)};" for z, value in restarted]
        return ["", "IF RESET_ESTIMATES THEN", *lines, "END_IF;"] if lines else []

    def _limiter(self) -> list[str]:
        if not self.monitor.limit_reference:
            return []
        bounds = zip(self.program.Y, map(st_literal, self.monitor.reference_bounds), strict=True)
        lines = [f"{self.followed[y]} := LIMIT(-{b}, {self.names[y]}, {b});" for y, b in bounds]
        return ["", "(* the reference within its bounds *)", *lines]

    def _disabled(self, saved: Mapping[str, str]) -> list[str]:
        """A disabled controller gives no command and learns nothing; differences go on."""
        names = self.names
        lines = [
            f"{names[z]} := {saved[names[z]] if value is None else st_literal(value)};"
            for z, value in self.monitor.disabled.items()
        ]
        lines.append(f"{names[COMMAND]} := {st_literal(self.monitor.off)};")
        note = "(* disabled: no command, no learning; differences and filters go on *)"
        return ["", note, "IF NOT ENABLE THEN", *(INDENT + line for line in lines), "END_IF;"]

    def _judged(self, saved: Mapping[str, str]) -> Iterator[str]:
        """The flags, their latches and the sum of them."""
        held, _ = self.flags[HELD]
        texts = {**self.names, COMMAND_BEFORE: saved[self.names[COMMAND]]}
        yield from ("", "(* what does not hold: at this sample, and since CLEAR_FLAGS *)")
        for flag in self.monitor.flags:
            now, latched = self.flags[flag.name]
            if flag.premises:
                gate = "" if flag.always else f"NOT {held} AND "
                gate = f"ENABLE AND {gate}" if flag.of_command else gate
                yield f"{now} := {gate}NOT ("
                yield from _joined(_conditions(flag, texts), "AND")
                yield ");"
            yield f"{latched} := (ENABLE AND {now}) OR ({latched} AND NOT CLEAR_FLAGS);"
        yield f"{PREMISES_HOLD} := NOT ("
        yield from _joined([latched for _, latched in self.flags.values()], "OR")
        yield ");"


def _joined(conditions: Sequence[str], operator: str) -> list[str]:
    """Conditions, one a line."""
    return [f"{INDENT}{c} {operator}" for c in conditions[:-1]] + [INDENT + conditions[-1]]


def _conditions(flag: Flag, names: Mapping[sympy.Symbol, str]) -> list[str]:
    """What is TRUE while the premises of a flag hold."""
    printer = Statements(Variables(names))

    def condition_text(premise: Within) -> str:
        value, low, high = map(printer.text, (premise.value, premise.low, premise.high))
        least, most = (">", "<") if premise.strict else (">=", "<=")
        return f"({value} {least} {low}) AND ({value} {most} {high})"

    return [condition_text(premise) for premise in flag.premises]
