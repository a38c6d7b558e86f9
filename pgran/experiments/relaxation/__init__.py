"""One bond a step, by windows of algebra; its spectrum and memory."""
