"""Sensors measured as EMVA 1288 does."""
