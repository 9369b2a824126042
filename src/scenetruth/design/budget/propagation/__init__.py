"""Models of methods: the errors of their estimates, linear in what is wrong with the images."""
