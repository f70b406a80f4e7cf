"""Damaged inputs of every kind, and the command lines that read them."""
