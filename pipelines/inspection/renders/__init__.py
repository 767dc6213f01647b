"""Diagnosis of renders from any source: their faults, and the conventions behind a reported
number.
"""
