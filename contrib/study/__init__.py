"""Metric study: degradations of known strength planted in true frames, and how every metric answers
them.
"""
