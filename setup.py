# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Build of the package, with pip and with colcon (ament_python) alike."""

from pathlib import Path

from setuptools import find_packages, setup

NAME = "uw_visibility"
# colcon build --symlink-install calls a link to this file in its build folder, beside which are
# links to the package and to what data_files names, and to nothing else.
SOURCE = Path(__file__).resolve().parent


def files(folder: str, pattern: str) -> list[str]:
    """Return what data_files takes: paths that are relative to this file."""
    return sorted(str(file.relative_to(SOURCE)) for file in (SOURCE / folder).glob(pattern))



setup(
    name=NAME,
    # Written here and into package.xml by catkin_prepare_release, which wants it as it stands;
    # everything else asks the installed package.
    version="0.2.0",
    description="Underwater visibility, colour and stereo from a stereo camera",
    long_description=(SOURCE / "README.md").read_text(encoding="utf-8"),
    long_description_content_type="text/markdown",
    author="the uw_visibility developers",
    maintainer="the uw_visibility developers",
    # The project has no address: example.org is reserved (RFC 2606).
    maintainer_email="uw_visibility@example.org",
    license="Apache-2.0",
    license_files=["LICENSE"],
    keywords=["underwater", "stereo", "visibility", "attenuation", "AUV", "ROS 2"],
    classifiers=[
        "Development Status :: 4 - Beta",
        "Environment :: Console",
        "Intended Audience :: Science/Research",
        "License :: OSI Approved :: Apache Software License",
        "Operating System :: POSIX :: Linux",
        "Programming Language :: Python :: 3",
        "Programming Language :: Python :: 3.11",
        "Programming Language :: Python :: 3.12",
        "Topic :: Scientific/Engineering :: Image Processing",
        "Topic :: Scientific/Engineering :: Oceanography",
        "Typing :: Typed",
    ],
    python_requires=">=3.11",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={
        NAME: ["py.typed"],
        f"{NAME}.data": ["*.csv", "*.npz", "*.txt"],
        f"{NAME}.replay.report": ["templates/*"],
        f"{NAME}.ros": ["*.xml"],
    },
    data_files=[
        # What ros2 run, ros2 launch and ament's index look for.
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/config", files("config", "*.*")),
        (f"share/{NAME}/launch", files("launch", "*.launch.*")),
        (f"share/{NAME}/foxglove", files("foxglove", "*.json")),
        (f"share/{NAME}/integration", files("integration", "*")),
    ],
    # Tables are read as files, and compiled kernels are cached beside their source.
    zip_safe=False,
    install_requires=[
        "numba>=0.58",
        "numpy>=1.26",
        "opencv-python-headless>=4.6",
        "pillow>=10.0",
        "PyYAML>=6.0",
        "scipy>=1.11",
    ],
    extras_require={
        # On a robot these come from apt with ROS 2 Jazzy itself.
        "ros": ["ros-jazzy-common-interfaces", "ros-jazzy-rclpy[fastrtps]"],
        # Commands that draw and show progress.
        "report": ["jinja2>=3.1", "matplotlib>=3.6", "tqdm>=4.66"],
        # Commands that read and write recordings; the only library that no apt has.
        "recordings": ["rosbags>=0.11.9", "lz4"],
        # Both of them: replay, calibrate and simulate on a computer without ROS.
        "replay": ["jinja2>=3.1", "lz4", "matplotlib>=3.6", "rosbags>=0.11.9", "tqdm>=4.66"],
        # replay --scheduler, on a Dask cluster that is there already.
        "distributed": ["distributed>=2024.1"],
        # Recordings and results at URLs; most stores need a package of theirs beside it.
        "stores": ["fsspec>=2024.2"],
        # The site, see docs/; its tutorials are run when it is built.
        "docs": [
            "myst-parser>=4",
            "numpydoc>=1.8",
            "pydata-sphinx-theme>=0.16",
            "sphinx>=8",
            "sphinx-copybutton",
            "sphinx-design",
            "sphinx-gallery>=0.18",
        ],
        # stereo.matcher and enhancement.restorer onnx; onnxruntime-gpu or -openvino do as well.
        "onnx": ["onnxruntime>=1.17"],
        # replay --netcdf and --parquet.
        "netcdf": ["xarray>=2024.2", "netCDF4>=1.6"],
        "parquet": ["pyarrow>=14"],
        # Words that the shell completes; see the command's help.
        "completion": ["argcomplete>=3.1"],
        # Beside the tools, other people's readers of what is written here: the checker of
        # CF, geopandas, mcap, a browser.
        "test": [
            "compliance-checker",
            "geopandas",
            "hypothesis",
            "import-linter",
            "mcap",
            "mypy",
            "onnx",
            "playwright",
            "pytest",
            "pytest-timeout",
            "pytest-xdist",
            "ruff",
            "types-PyYAML",
        ],
    },
    entry_points={
        "console_scripts": [
            f"uw_visibility = {NAME}.cli:run",
            f"uw_visibility_node = {NAME}.ros.start:node",
            f"uw_visibility_lifecycle_node = {NAME}.ros.start:lifecycle_node",
        ],
    },
)
