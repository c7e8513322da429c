"""The sections of the experiment on PLRs without an oracle."""
