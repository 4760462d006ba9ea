"""Filters side by side: how far each is from the truth, clean and with spoilt stance decisions."""
