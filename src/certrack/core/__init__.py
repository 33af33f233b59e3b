"""What every other room stands on: messages, checks of input, formulas, their lowering, files."""
