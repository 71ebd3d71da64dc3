"""The data of figures: reduced, summarised and encoded, before anything is drawn."""
