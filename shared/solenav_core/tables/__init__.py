"""Constant tables, written by the scripts in tools/tables/."""
