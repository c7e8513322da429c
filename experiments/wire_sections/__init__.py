"""Sections of the experiment about files on their way: one file each, with what measures and what prints."""
