"""The one room with plots and pages."""
