"""Definitions that all packages share: types, tables, rules, geometry, wording, marks and errors.

This package imports no other package of jrdb_avr.
"""
