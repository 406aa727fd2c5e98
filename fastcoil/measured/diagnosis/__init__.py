"""What a trend log of a loop tells: the backlash of its valve."""
