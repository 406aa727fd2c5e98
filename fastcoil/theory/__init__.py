"""Why a loop hunts: describing functions and limit cycles."""
