"""Diagnosis of captures and of renders: findings, each with its evidence and its remedy."""
