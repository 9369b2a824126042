"""Figures of an estimate's errors: sizes with confidence intervals, what confidence is worth, steps and waves."""
