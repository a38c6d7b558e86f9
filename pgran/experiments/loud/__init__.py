"""Loud sound: contacts by their own law, which open and close, in periodic states."""
