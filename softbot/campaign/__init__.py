"""Campaigns: thousands of runs drawn from distributions over robots, floors, orders and faults, and what they show."""
