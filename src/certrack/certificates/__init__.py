"""Certificates: bounds on limsup |e_1(t)| that hold for everything the assumptions admit.

Each method is a file: `published` (the paper's, and two sound forms of it), `semidefinite`,
`cascade` with its `centred` stage; `bootstrap` is the room of quadratic functions on the set that
such a proof reaches; `ranges` is the room of constants that have a range, whose peak gains serve
loops without ranges, too, and `online` that of gains that move; `methods` lists them all. They
share `problem` (the error system as a matrix inequality), `scaling` (the units a solver sees it in)
and `adaptation` (the update laws' part), which `formulation` fills from a system whose law obeys
the error system that it states (`stated`), `own_multipliers` (a proof without a solver), `exact`
(verification), `strength` (up to which scale of tau there is one), `document` (the saved
certificate and its checker) and `tube` (the bound for every t, from the `start` in `balls`).

How much input a law asks for is bounded by `input_bounds`, with `input_problem`, `input_program`
and `mean_squares`. Which systems have a certificate at all is said by `scope`. What a bound rests
on is a list of `premise` records, made by `premises_of_truth` (by `reference_premise` for y_d);
`assumptions` has it as texts. What the truth keeps of Assumption 1 is found by `majorants` and
`cover`, where formulas are defined by `domain`. `estimates` are bounds in floats with their
gradients, for searches.

A bound is a claim that others build on, so the author of a new method must:

1. take a :class:`~certrack.systems.system.System` and nothing else, and build its data by
   ``error_problem(system, rational)`` (`decimal` where it claims no exactness), which refuses the
   systems for which V' <= -alpha V + Delta is not proven. Where there is no certificate, raise
   NoCertificate with the reason and the remedy, and return ``missing(kind, reason)``; never a
   number that is "probably" a bound;
2. optimise as it likes, in floats (``problem.in_floats()``), and treat what a solver returns as a
   guess. Round it to decimals and check **every** condition of the theorem in exact rationals:
   signs, P >= e_1 e_1^T, the inequality, the leakage, and that bound^2 is not below what they give.
   Only then is ``verified`` true (``exact.prove`` and ``exact.proven``). A bound that nobody has
   proven says ``verified = False``, like the paper's, and never becomes the best;
3. round outward wherever a float stands for a real number: bounds of the reference, intervals and
   the printed bound up, a rate down. tests/test_rounding.py shows for every such step what would be
   claimed without it; a new step joins it;
4. list in :mod:`premises_of_truth` what the claim rests on beyond what is there already, each with
   what is known of it, and name it in docs/certificate-file.md;
5. write into the document all that a third party needs, and check there what was proven, from the
   text of the system alone and with no solver: ``to_document`` and ``verify``. Another layout of
   the proof is another FORMAT, described in docs/certificate-file.md, and files of the old one stay
   readable;
6. enter :func:`methods.every_certificate`, the one list of all methods, be a field of
   :class:`Certificates`, and have a note in the report of the command line. A tube follows from the
   stages of its proof (:mod:`tube`), if it is a quadratic function;
7. prove by tests that a document with any of its numbers changed for the better is refused (the
   MUTANTS of tests/test_certificates.py), and that no run and no search exceeds the bound.
"""

from certrack.certificates.certificate import Certificate, NoCertificate
from certrack.certificates.certify import Certificates, certify
from certrack.certificates.document import save_certificate, to_document
from certrack.certificates.estimates.estimate import BoundEstimate, TubeEstimate, estimate
from certrack.certificates.exact import Proof
from certrack.certificates.input_bounds import InputBounds, certify_input
from certrack.certificates.methods import best_sound_bound, certify_peak, certify_semidefinite
from certrack.certificates.premise import Premise
from certrack.certificates.premises_of_truth import premises
from certrack.certificates.tube import Tube, tube
from certrack.certificates.verification import Verdict, verify

__all__ = [
    "BoundEstimate",
    "Certificate",
    "Certificates",
    "InputBounds",
    "NoCertificate",
    "Premise",
    "Proof",
    "Tube",
    "TubeEstimate",
    "Verdict",
    "best_sound_bound",
    "certify",
    "certify_input",
    "certify_peak",
    "certify_semidefinite",
    "estimate",
    "premises",
    "save_certificate",
    "to_document",
    "tube",
    "verify",
]
