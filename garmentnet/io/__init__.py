"""Files written whole or not at all, and TOML tables read into dataclasses."""
