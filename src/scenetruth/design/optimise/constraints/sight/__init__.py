"""What constraints on sight measure: distances, fields, blur, disparity, texture."""
