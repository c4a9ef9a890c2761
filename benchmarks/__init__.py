"""Suites that measure this package beside its rivals: ``python -m benchmarks.<suite>``."""
