"""Site builder: ``numbers`` fills the pages, ``stage`` prepares them for Sphinx, ``links`` checks the result."""
