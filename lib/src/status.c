/* One message for each status, in the order of their numbers, from 0 down. */

COLD const char *KOOP(status_message)(int status) {
	/* in one piece: an array of pointers is longer, and is kept where no message is asked for */
	static const char messages[] =
	    "ok\0"
	    "a pointer that must be given is null\0"
	    "a dimension is zero or too large, or sizes do not agree\0"
	    "the storage handed over is too small\0"
	    "a setting is outside its range\0"
	    "an input is NaN or infinite\0"
	    "the result would not be finite in this precision\0"
	    "the covariance, or the controller's Hessian, would not be positive definite\0"
	    "the stored model is damaged or is of another kind\0"
	    "the sample differs from what the model has come to expect by more than the gate lets pass\0"
	    "bits have flipped in what was learned, more than can be mended\0"
	    "the arithmetic is not that of IEEE 754 as this was compiled and started\0"
	    "unknown status";
	const char *message = messages;
	for (int s = status > 0 || status < KOOP_E_ARITHMETIC ? KOOP_E_ARITHMETIC - 1 : status; s < 0; s++) {
		while (*message++) {}
	}
	return message;
}
