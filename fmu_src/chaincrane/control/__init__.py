"""What closes a loop around a crane: an observer and an anti-sway controller."""
