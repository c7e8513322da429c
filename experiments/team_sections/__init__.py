"""The sections of the experiment on teams."""
