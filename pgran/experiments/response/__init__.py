"""A sweep: points or proven curves, phases and slopes."""
