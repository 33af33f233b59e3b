"""The sampled loop for constants with ranges: sound against members, tight, checked, or refused."""

import math
from dataclasses import replace

import independent_checker
import numpy as np
import pytest

import certrack
from certrack.certificates import certify, to_document, verify
from certrack.certificates.implemented.certify import certify_implemented
from certrack.model.implementation import Implementation

#: Step of a 12-bit encoder, rad.
ENCODER = 2 * math.pi / 2**12


def joint(T, c0=(0.79184, 1.18776), **entries):
    """The flexible joint on a drive, with encoders on both shafts."""
    system = certrack.load("flexible-joint")
    drive = {"period": T, "delay": 0.5, "measurement_quantum": (ENCODER, 0.0, ENCODER, 0.0)}
    plant = replace(system.plant, constant_ranges=(("c0", *c0),)) if c0 else system.plant
    return system.replace(plant=plant, implementation=Implementation(**(drive | entries)))


def test_x():
    system = certrack.load("flexible-joint").replace(reference=certrack.SymbolicReference("0.7854*sin(2*t)"), implementation=Implementation(period=0.004, delay=0.5,  measurement_quantum= (ENCODER, 0.0, ENCODER, 0.0)))
    found, proofs = certify_implemented(system)
    print(found, found.cells)
    d = to_document(system, *proofs)
    print(independent_checker.check(d))
