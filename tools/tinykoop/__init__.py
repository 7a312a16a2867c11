"""Host tools of TinyKoop: experiments, plots and reports on what lib/ and host_sim/ compute."""
