"""Settings: conversion and validation of input, classes by name."""
