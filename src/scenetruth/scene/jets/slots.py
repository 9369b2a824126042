"""Rows of the coefficients of jets in time t and two coordinates a, b along a surface."""

__all__ = ["AA", "AB", "ACROSS", "ALONG", "BB", "TA", "TB", "TIME", "TT", "VALUE", "A", "B", "T"]

TIME, ALONG, ACROSS = range(3)
"""Numbers of the variables: t, and the surface coordinates a and b."""

VALUE, T, A, B, TT, TA, TB, AA, AB, BB = range(10)
"""Rows: the value, the first derivatives by t, a and b, and the second derivatives."""
