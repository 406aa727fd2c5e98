"""Errors, arguments, files, text, figure style."""
