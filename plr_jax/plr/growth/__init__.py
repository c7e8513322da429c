"""Which leaf is split next, along which axis, and until when."""
