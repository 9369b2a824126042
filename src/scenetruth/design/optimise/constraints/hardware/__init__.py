"""What constraints on the hardware measure: travel, stage errors, prices."""
