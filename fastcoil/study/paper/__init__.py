"""The paper, figure by figure and claim by claim: ``fastcoil paper``."""
