"""Apply recipes to a fleet of sensors on Spark: batch jobs over a lake, and streams with a stored state.

Example::

    with session("local[4]") as spark:
        fleet = clean(spark, Path("lake"), Path("clean"), open_book(recipe=Path("pump.toml")))
    print(fleet.summary, fleet.report)
"""

from becalm.fleet.batch import BatchOptions, Fleet, clean
from becalm.fleet.recipes import RecipeBook, open_book
from becalm.fleet.session import session

__all__ = ["BatchOptions", "Fleet", "RecipeBook", "clean", "open_book", "session"]
