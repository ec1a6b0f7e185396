"""The pages, and what runs their snippets."""
