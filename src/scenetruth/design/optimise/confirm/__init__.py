"""The confirmation: the best rigs simulated, estimated and scored, with several seeds."""
