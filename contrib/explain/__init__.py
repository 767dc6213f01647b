"""Whole tables checked: every cell of a published table against scored runs, and the conventions
that would explain it.
"""
