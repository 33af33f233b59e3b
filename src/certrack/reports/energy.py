"""What is said of the energy of two motors: tables of the balance and of the splits."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from certrack.reports.tables import Table, short_number, table

if TYPE_CHECKING:
    from certrack.studies.energy import Energy, EnergyBalance, TorqueSplit

#: Rows of the balance: attribute, entry of a pair, label, sign on the side of the source.
BALANCE_ROWS = (
    ("drawn", "drawn from the source"),
    ("returned", "- returned to the source"),
    ("net", "= net"),
    ("copper_1", "copper loss, motor 1"),
    ("copper_2", "+ copper loss, motor 2"),
    ("friction", "+ friction"),
    ("stored", "+ growth of stored energy"),
    ("surroundings", "- work of the disturbances"),
    ("chopper", "+ brake chopper"),
    ("supply_loss", "+ loss in the supply"),
    ("accounted", "= accounted for"),
    ("residual", "missing"),
)

#: So many cycles are shown: the first and the last ones.
SHOWN_CYCLES = 3

#: A twist in the tail above this part of the largest one is called persistent.
PERSISTENT_PART = 0.5


def balance_entry(balance: EnergyBalance, name: str) -> float:
    """An entry of the balance by the name of its row, J."""
    if name == "accounted":
        return balance.losses + balance.stored - balance.surroundings
    if name.startswith("copper_"):
        return balance.copper[int(name[-1]) - 1]
    return float(getattr(balance, name))


def energy_table(result: Energy, title: str = "") -> Table:
    """The balance in joules: the whole run, then its cycles."""
    cycles = result.cycles
    shown = list(enumerate(cycles))
    if len(cycles) > SHOWN_CYCLES:
        shown = [shown[0], *shown[1 - SHOWN_CYCLES :]]
    columns = ["energy [J]", "run", *(_cycle_label(result, i) for i, _ in shown)]
    balances = [result.balance, *(entry for _, entry in shown)]
    rows = [
        [label, *(balance_entry(balance, name) for balance in balances)]
        for name, label in BALANCE_ROWS
    ]
    return table(title, columns, rows)


def split_table(result: Energy) -> Table:
    """The ways to share the input, a row each, and what they come to over the run."""
    even = sum(result.splits[1].balance.copper)
    names = ("stated", "even", "best")
    rows = [
        [name, *_split_row(split, even)] for name, split in zip(names, result.splits, strict=True)
    ]
    columns = [
        *("split", "share", "copper 1 [J]", "copper 2 [J]", "saved", "net [J]"),
        *("twist [rad]", "in tail [rad]"),
    ]
    return table("", columns, rows, digits=4)


def motor_table(result: Energy) -> Table:
    """Load of each motor over the run."""
    numbers = result.motors
    rows = [
        [
            f"motor {i + 1}",
            numbers.resistance[i],
            numbers.torque_constant[i],
            result.rms_current[i],
            result.rms_torque[i],
            result.balance.copper[i],
            result.balance.work[i],
        ]
        for i in range(2)
    ]
    columns = [
        *("", "R [ohm]", "k [N m/A]", "RMS current [A]", "RMS torque [N m]"),
        *("copper [J]", "work [J]"),
    ]
    return table("", columns, rows, digits=4)


def energy_notes(result: Energy) -> list[str]:
    """What the split and the supply save, and what is to be known of it."""
    return list(_energy_notes(result))


def _energy_notes(result: Energy) -> Iterator[str]:
    _, even, best = result.splits
    yield (
        f"the best share, {best.share:.4g}, saves {_percent(result.saving_by_split)} of the copper "
        f"loss of the even one; the formula says {_percent(result.motors.best_saving)} for a given "
        "torque without damping"
    )
    if best.tail_twist > max(PERSISTENT_PART * best.twist, 10 * even.tail_twist, 1e-9):
        yield (
            f"with it the shafts swing against each other by {best.tail_twist:.3g} rad from end to "
            "end in the tail: their difference needs truth.motors.damping (--damping)"
        )
    supply = result.system.truth.supply
    over = "run", result.balance
    if result.cycles:
        over = "last cycle", result.cycles[-1]
    where, balance = over
    if supply is not None and supply.kind == "battery":
        yield (
            f"regeneration returns {balance.returned:.4g} J in the {where}, "
            f"{_percent(balance.regenerated)} of what is drawn; a chopper would burn it"
        )
    else:
        without = "" if supply is not None else "no [truth.supply]: a brake chopper is assumed; "
        part = balance.given_back / balance.drawn if balance.drawn else 0.0
        yield (
            f"{without}the chopper burns {balance.chopper:.4g} J in the {where}; a battery without "
            f"losses would return {_percent(part)} of what is drawn"
        )
    worst = max((result.balance, *result.cycles), key=lambda entry: abs(entry.residual))
    yield f"the balance closes to {short_number(abs(worst.residual), 2)} J"


def _split_row(split: TorqueSplit, even: float) -> list[object]:
    copper = split.balance.copper
    saved = 1 - sum(copper) / even if even else 0.0
    return [
        split.share,
        *copper,
        _percent(saved),
        split.balance.net,
        split.twist,
        split.tail_twist,
    ]


def _percent(part: float) -> str:
    return f"{100 * part:.2f} %"


def _cycle_label(result: Energy, index: int) -> str:
    entry = result.cycles[index]
    return f"{entry.begin:.4g} to {entry.end:.4g} s"
