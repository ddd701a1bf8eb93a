from tirefit.cli import main

main()
