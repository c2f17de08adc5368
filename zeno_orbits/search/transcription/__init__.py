"""search.transcription."""
