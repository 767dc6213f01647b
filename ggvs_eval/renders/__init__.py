"""Renders from elsewhere: folders, videos, arrays and archives of frames become a method of
a run.
"""
