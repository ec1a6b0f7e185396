"""Files written complete or not at all, TOML tables read into dataclasses."""
