"""Robots: the contract, its safety rules, and a driver for each controller."""
