"""The ground floor of the compiled half: compiler flags, elementary functions, random numbers.  No physics."""
