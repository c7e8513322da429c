"""What has changed from one PLR to another, in few bytes."""
