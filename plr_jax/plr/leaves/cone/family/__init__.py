"""Many PLRs of one workspace at once: cells that are alike for several goals are looked at once for all of them."""
