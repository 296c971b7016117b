"""Drives of points: poles, true motion and sensors with stated errors, without pictures."""
