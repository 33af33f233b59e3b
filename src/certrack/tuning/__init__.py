"""Gains under the certificate: one quantity is optimised, the others are limits."""
