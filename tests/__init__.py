"""Tests: one file a module, and problems whose answers are known in closed form."""
