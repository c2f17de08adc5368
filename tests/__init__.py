"""Tests: one file a module, and scenes whose answers are known in closed form."""
