"""Files written complete or not at all, and TOML tables read into dataclasses."""
