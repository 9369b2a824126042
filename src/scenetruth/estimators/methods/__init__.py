"""The methods that come with the package: one module each, named as the method, holding it as ``METHOD``."""
