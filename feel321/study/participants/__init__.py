"""Participants: who takes part under which number, personal answers, and people who withdraw."""
