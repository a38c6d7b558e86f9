"""Ranks in groups, the journal of finished work, agreement over ranks, progress."""
