"""Fuzzers: generated system files, formulas, certificates, samples and ensemble folders."""

KINDS = ("systems", "expressions", "certificates", "samples", "chunks")


def fuzzer(kind):
    """The fuzzer of a kind."""
    from fuzz import certificates, chunks, expressions, samples, systems

    return {
        "systems": systems.Systems,
        "expressions": expressions.Expressions,
        "certificates": certificates.Certificates,
        "samples": samples.Samples,
        "chunks": chunks.Chunks,
    }[kind]()
