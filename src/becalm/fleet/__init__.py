"""Recipes over a fleet, on Spark: files and stretches of time as tasks, and streams that keep their state.

Such as::

    with session("local[4]") as spark:
        fleet = clean(spark, Path("lake"), Path("clean"), open_book(recipe=Path("pump.toml")))
    print(fleet.summary, fleet.report)
"""

from becalm.fleet.batch import BatchOptions, Fleet, clean
from becalm.fleet.recipes import RecipeBook, open_book
from becalm.fleet.session import session

__all__ = ["BatchOptions", "Fleet", "RecipeBook", "clean", "open_book", "session"]
