"""The controller as Structured Text for PLCs (IEC 61131-3)."""

from certrack.export.st.function_block import structured_text

__all__ = ["structured_text"]
