"""The controller as Structured Text for PLCs (IEC 61131-3)."""

from certrack.export.st.function_block import export_st, structured_text

__all__ = ["export_st", "structured_text"]
