"""Poles of single frames to tracks in the vehicle frame."""
