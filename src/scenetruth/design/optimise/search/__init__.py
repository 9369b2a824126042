"""The search: predictions by the thousand, what parameters do, and the front."""
