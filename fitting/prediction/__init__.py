"""What treatments would do: outcomes of many variants, with an estimate's uncertainty."""
