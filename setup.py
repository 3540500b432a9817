"""What colcon needs beside pyproject.toml: the package's place in the ament index."""

from setuptools import setup

setup(
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/pallet_twin"]),
        ("share/pallet_twin", ["package.xml"]),
    ]
)
