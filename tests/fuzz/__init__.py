"""Fuzzers: generated system files, formulas, certificates, samples and ensemble folders."""

KINDS = ("systems", "expressions", "certificates", "samples", "chunks")


def fuzzer(kind):
    """The fuzzer of a kind."""
    from importlib import import_module

    return getattr(import_module(f"fuzz.{kind}"), kind.capitalize())()
