"""The console: a page in the browser from which a brain is watched and taught."""
