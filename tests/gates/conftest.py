"""Calls that the gates of arguments and of labels make wrong."""

from helpers.public_calls import base_calls, cheap, in_a_folder_of_its_own

__all__ = ["base_calls", "cheap", "in_a_folder_of_its_own"]
