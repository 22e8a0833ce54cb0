"""Readers of files: tables of named columns, before anything is known of the robot."""
