"""Write reports on cleaned recordings and fleets: HTML pages and printed figures."""
