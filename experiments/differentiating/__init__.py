"""Sections of the experiment ``gradients``: distances whose walls, goals or stored values change."""
