"""Certificates: bounds on limsup |e_1(t)| that hold for everything the assumptions admit."""

from certrack.certificates.certificate import Certificate, NoCertificate
from certrack.certificates.certify import (
    Certificates,
    best_sound_bound,
    certify,
    certify_semidefinite,
)
from certrack.certificates.document import Verdict, save_certificate, to_document, verify
from certrack.certificates.exact import Proof
from certrack.certificates.tube import Tube, tube

__all__ = [
    "Certificate",
    "Certificates",
    "NoCertificate",
    "Proof",
    "Tube",
    "Verdict",
    "best_sound_bound",
    "certify",
    "certify_semidefinite",
    "save_certificate",
    "to_document",
    "tube",
    "verify",
]
