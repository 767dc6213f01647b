"""Diagnosis of renders, whoever made them: their faults, and the conventions behind a reported number."""
