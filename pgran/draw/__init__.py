"""Pages, axes, marks and maps: what figures of several experiments share."""
