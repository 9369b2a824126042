"""What people read and see of a budget: words, the waterfall, a page."""
