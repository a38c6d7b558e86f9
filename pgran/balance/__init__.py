"""Balls in mechanical equilibrium: contact laws, who touches whom, rest under these forces."""
